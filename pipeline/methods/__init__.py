"""The six methods, from `nominal` to `hybrid`: what they predict, command and score, and how sure they are."""
