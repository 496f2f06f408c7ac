"""Response curves: solutions followed along a parameter, their stability and bifurcations."""
