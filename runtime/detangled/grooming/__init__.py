"""What happens to strands on a head: guides, lengths, placing."""
