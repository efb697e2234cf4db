"""Networks and datasets for others: cards that describe them, and upload to and download from a model hub."""
