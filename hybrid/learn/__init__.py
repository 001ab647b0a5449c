"""Networks: what they are, how they read a photo, and how they are trained.

``networks`` are those that users get, ``reading`` what these make of a photo, ``datasets`` what they learn from,
``paper`` the paper's networks and its baselines, ``training`` the trainer of all. Each of these imports only those
before it, and rectifying needs only the first two.
"""
