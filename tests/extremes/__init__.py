"""Stability at the extremes: every row is a test with its figure.

`pytest tests/extremes -m "slow or not slow"` prints all of them as one table.
"""
