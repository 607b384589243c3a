"""What imucald finds, handed on to others: MQTT, KUKSA. Companions, never in the daemon's loop."""
