"""The Foxglove Protobuf schemas, in which fbench writes its own logs."""
