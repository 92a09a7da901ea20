"""What a case takes: its blocks are said by `contactqp.scene.explaining`, what they cost is measured here."""
