"""How well the backlash model fits real records, and what it costs."""
