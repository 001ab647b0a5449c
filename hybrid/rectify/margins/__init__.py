"""Margins around the print: where on the sheet it lies, and where the sheet ends beside it."""
