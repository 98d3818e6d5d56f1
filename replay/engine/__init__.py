"""From messages to a run: `clock`, `frame_buffer`, `frames`, `excerpt`, `read_ahead`, and the one loop (`loop`)."""
