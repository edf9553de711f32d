"""The servo: drive, friction law, encoder."""
