"""How stages run: keys and fingerprints, the cache, workers, verification."""
