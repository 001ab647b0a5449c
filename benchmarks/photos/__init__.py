"""Photos whose truth is known, and changes of them that leave it known."""
