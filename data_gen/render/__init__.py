"""The light that reaches the camera from the film and from everything around it."""
