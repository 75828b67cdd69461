"""The stages of the pipeline: plain typed functions, values in, values out."""
