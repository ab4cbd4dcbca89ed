"""What the scripts of several questions need."""
