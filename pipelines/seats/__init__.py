"""The seats in the browser: who may come in, what a page is sent, and what it may send."""
