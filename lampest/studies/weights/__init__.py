"""What `weight: auto` did: true curves over the weight of a penalty, and where every rule stands on them."""
