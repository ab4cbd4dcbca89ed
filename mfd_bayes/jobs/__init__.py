"""Work in other processes or on a cluster, and its news."""
