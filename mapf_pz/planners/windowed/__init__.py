"""Planning within a window: collision-free paths over the next steps, improved by large neighborhood search."""
