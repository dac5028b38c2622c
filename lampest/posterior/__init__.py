"""How certain an estimate is: its error in log r from the noise of the readings and from what the penalties do."""
