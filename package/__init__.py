"""Bristle: servo friction and the adaptive observers that identify it, as FMUs."""
