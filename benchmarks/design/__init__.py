"""Whether bounding properties hold what tests showed that were left out."""
