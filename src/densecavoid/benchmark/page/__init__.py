"""`index.html`: a benchmark's results on one page that needs nothing else, for readers who do not know the paper."""

from densecavoid.benchmark.page.page import write_page

__all__ = ["write_page"]
