"""Models shown, exported, proposed, adopted and promoted."""
