"""Inverse problems: what lights or materials make given pictures or measurements."""
