"""Virtual robots: known errors, measurements of themselves, and siblings of one design."""
