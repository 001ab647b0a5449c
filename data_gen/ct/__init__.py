"""CT volumes: read from files, or made up."""
