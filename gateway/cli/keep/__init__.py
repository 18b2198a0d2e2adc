"""What is kept: configurations, copies, and what is sent to support."""
