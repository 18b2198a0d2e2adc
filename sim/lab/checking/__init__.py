"""Models checked: a query and its text, what is proven, what runs say."""
