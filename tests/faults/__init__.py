"""Files cut, mutated and lying, loaded in processes of their own; `python -m tests.faults` prints what came of them."""
