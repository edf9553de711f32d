"""From a program to an FMU."""
