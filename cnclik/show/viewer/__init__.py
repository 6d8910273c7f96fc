"""The viewer: one run of a robot in a browser, drawn by viser (extra `viewer`)."""
