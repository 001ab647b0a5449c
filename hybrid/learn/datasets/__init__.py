"""Data sets, and the views of their samples that the networks are trained on."""
