"""Whether statistical tests hold for other seeds and on other processors."""
