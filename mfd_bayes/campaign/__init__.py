"""The campaign file: read, drafted, or invented for the demo."""
