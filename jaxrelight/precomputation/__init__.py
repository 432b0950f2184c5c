"""From a scene to a store, pass by pass, and from a store to what lights."""
