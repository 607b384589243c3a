"""Thousands of logs of hundreds of vehicles: evaluated one by one, then read together."""
