"""Counting what XLA is given to compile."""

import contextlib

import jax.monitoring


@contextlib.contextmanager
def compilations():
    """Lists the programs that are compiled within the block, by name."""
    programs: list[str] = []

    def listen(event: str, duration_secs: float, **details):
        del duration_secs
        if event == "/jax/core/compile/backend_compile_duration":
            programs.append(str(details.get("fun_name", "")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield programs
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
