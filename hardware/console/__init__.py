"""The operator's console: a page on 127.0.0.1 that speaks to the car over the operator's radio."""
