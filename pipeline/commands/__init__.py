"""The command line: a thin skin on the interface. It parses arguments and prints results."""
