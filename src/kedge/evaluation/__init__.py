"""How good an estimate is, and whether it knows: accuracy, consistency, studies, reports."""
