"""Send the results of a daemon to MQTT, KUKSA or Foxglove. Feeds run in a separate process, never
in the daemon."""
