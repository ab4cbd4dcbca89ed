"""Work in other processes or on a cluster, and the news of its progress."""
