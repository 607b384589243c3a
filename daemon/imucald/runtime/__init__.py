"""From frames to frames: pipeline, engine, consumers, output, replay."""
