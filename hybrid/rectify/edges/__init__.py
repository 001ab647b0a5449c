"""The sheet's edges in the photo: where the sheet ends, to a fraction of a pixel."""
