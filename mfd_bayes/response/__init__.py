"""A building with dampers in an earthquake, for many draws of its dampers at once."""
