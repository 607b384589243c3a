"""How much of a configuration `imucald init` finds."""
