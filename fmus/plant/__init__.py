"""The FMU ServoPlant."""
