"""The frames that imucald sends."""
