"""What a photo is taken of: the film, what holds it, and what is behind it, drawn at random."""
