"""What is compiled while a test runs."""

import contextlib

import jax


@contextlib.contextmanager
def compiled():
    """A list of what JAX and the engine compile meanwhile."""
    found = []

    def heard(event, begun, ended, **_):  # the engine reports no durations
        if "backend_compile" in event:
            found.append(event)

    jax.monitoring.register_event_time_span_listener(heard)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_time_span_listener(heard)
