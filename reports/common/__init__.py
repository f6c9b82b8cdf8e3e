"""What the studies share: trees made once, figures, pages."""
