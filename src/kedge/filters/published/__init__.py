"""Forms that stand in published papers, kept to repeat their figures."""
