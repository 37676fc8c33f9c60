"""What makes the documentation site: outputs of pages, generated reference, gallery, formulas."""
