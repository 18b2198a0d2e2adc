"""What is made once: a plant's folder, certificates, the software PLC, help in the shell."""
