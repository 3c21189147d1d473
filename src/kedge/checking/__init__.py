"""Whether a rig is honest on a log, without truth: hypotheses, predictions, observability."""
