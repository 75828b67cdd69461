"""Where results are kept: sealed folders that are renamed into place and checked when they are read."""
