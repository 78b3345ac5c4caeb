"""Reports of proofs, analyses, shapers and laws: figures, tables, HTML pages and PDF."""
