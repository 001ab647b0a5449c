"""From the exact map to the film: the photo is read, its light removed."""
