"""Film meshes: made, bent by a mass-spring solver, and seen by rays."""
