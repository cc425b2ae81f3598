"""Live view: a page on loopback that shows what the vehicle sees and intends (docs/view.md)."""
