"""What every public function of arrays can be differentiated in, as a table that tests and the guide read."""
