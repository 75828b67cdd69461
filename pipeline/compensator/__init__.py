"""Compensation at control rate: symbolic steps, and the C code that is generated from them."""
