"""Send imucald's results to MQTT, KUKSA or Foxglove. Feeds never run in the daemon's loop."""
