"""What is written back to the PLC: the block, who may write it and when."""
