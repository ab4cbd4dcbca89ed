"""Whether the posterior of all tests together is right, against NUTS and by simulation."""
