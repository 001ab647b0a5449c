"""The grid of slices on a roughly flat film: lines, borders, and what the cells have in common."""
