"""The coarse backward map: from what the network sees, or from the corners that a person gives."""
