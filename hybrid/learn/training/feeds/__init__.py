"""Feeds: where a network's batches come from, how it is tested and how its output is drawn."""
