"""Hostile input: valid files, spoiled; what kincal must do with each: take it, or say no in one line."""
