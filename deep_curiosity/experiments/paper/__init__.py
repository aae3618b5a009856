"""Tables, figures and page of the paper's two illustrations, computed with exact tables."""
