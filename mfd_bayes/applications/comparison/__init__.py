"""Parts of a campaign, and models, by what was left out: `crossvalidate` and `compare`."""
