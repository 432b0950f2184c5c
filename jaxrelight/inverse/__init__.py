"""Inverse problems: which lights or materials make given pictures or measurements."""
