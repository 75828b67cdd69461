"""Before anybody measures: which poses to measure, and what they will show."""
