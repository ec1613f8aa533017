"""The built-in studies: each makes a study, draws what its table shows, and writes one page."""
