"""Is this device like the others: rates of false alarms, and power."""
