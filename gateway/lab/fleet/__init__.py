"""Many machines of one type: a model of the type, what each has of its own, and which of them stands out."""
