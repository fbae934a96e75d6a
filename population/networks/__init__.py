"""Networks: how they are described, made, stacked and exported."""
