"""Several photos of one film become one: registered on the flat film, then merged."""
