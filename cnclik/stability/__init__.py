"""Which gain is safe at which sampling time."""
