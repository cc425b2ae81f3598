"""The service on ArduSub's own simulation, case by case."""
