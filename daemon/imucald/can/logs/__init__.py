"""Recorded CAN logs: read as columns of frames, written as candump text."""
