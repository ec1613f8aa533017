"""What a run comes to: signals, metrics, outcome, and the published figures beside them."""
