"""What `import kincal` offers. The command line is written on it."""
