"""From the coarse backward map to one that is exact to a fraction of a pixel."""
