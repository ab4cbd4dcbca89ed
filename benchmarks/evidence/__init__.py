"""Log evidence beside closed forms and beside nested sampling."""
