"""A decanter simulated by physics. It writes synthetic traces and is never the model under test."""
