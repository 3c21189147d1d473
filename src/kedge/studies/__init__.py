"""Monte Carlo studies: many filters over the same simulated runs, scored."""
