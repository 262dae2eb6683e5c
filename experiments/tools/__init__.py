"""Tools of the repository: generated files, and measured times."""
