"""Diagnosis of the simulation: what it gets wrong beside measured drives, why, and the gain."""
