"""The commands. Each has its own module, which is imported only when it is used."""
