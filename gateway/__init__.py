"""The gateway compares what the plant says with what it should do, and acts."""
