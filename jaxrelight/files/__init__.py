"""Files of arrays and tables, and the store that is made of them."""
