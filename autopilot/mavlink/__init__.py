"""The MAVLink server: one class per microservice, sans-IO."""
