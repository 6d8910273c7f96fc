"""What many loops teach."""
