"""Logs of public repositories that nobody tuned anything on, and what comes out of them."""
