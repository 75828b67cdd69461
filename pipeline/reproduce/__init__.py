"""The simulation of Xu, Tian and Zhang (2024): every table and figure of the paper."""
