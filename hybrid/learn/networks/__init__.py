"""The networks that users get, their weights, and how they are made ready for use."""
