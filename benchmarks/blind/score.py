def tables(pairs): raise NotImplementedError
