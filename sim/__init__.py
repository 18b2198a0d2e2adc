"""What the plant should do: the model, its laboratory, and a software PLC to try it on."""
