"""Scenes and problems that are posed: to a path tracer, to Blender, to the solver, to single parts of the code."""
